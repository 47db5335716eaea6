"""Effects of the stage sensor."""
