"""The words of the command line, command by command. Imports nothing heavy."""
