"""Campaigns: many runs of a scenario over seeds, grids and distributions of its fields."""
