"""A simulated rate table on a wire: commands in, frames of readings out."""
