"""An instrument on anybody's simulation: what a scenario states of its sensors, step by step."""
