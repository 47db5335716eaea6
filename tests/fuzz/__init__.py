"""Mutated inputs for every reader and command: none may end in a traceback, a hang, or partial
output.
"""
