"""The bench in a browser: a local web application over the commands."""
