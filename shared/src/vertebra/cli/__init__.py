"""The command line, one module per command; `./vertebra` in a checkout runs it."""
