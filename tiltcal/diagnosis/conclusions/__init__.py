"""From a fitted model to the answer: findings, statements, plots, the amended scenario."""
