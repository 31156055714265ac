"""The workbench: a local page that shows what answers hold and asks the next question on a click."""
