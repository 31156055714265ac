"""Report: the figures and the HTML page of an answer."""
