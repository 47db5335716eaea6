"""Effects of the stage electronics."""
