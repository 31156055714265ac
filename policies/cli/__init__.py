"""The command line: options, and the commands behind them."""
