"""Blind trials: a laboratory of its own (closed form, numpy only), concealed physics in it, and a
judge.

Nothing here imports the product: it is run as a command on copies of a recording and a scenario,
and its answers are read from files. What is concealed is written down only after the answer is in.

- rotations, motion: turning and moving
- laboratory: rigs, sequences and ordinary sensors of the seven kinds of set-up
- world, memory: from motion to readings, with hooks for physics that the scenario does not state
- mechanics, mount, sensing, rates, electronics, faults: what the catalogue lists
- unlisted: what it does not, by the author of the search
- second_author and its parts: what it does not, by one who has not read the search
- noise, nuisance, second_author_nulls: what is ordinary, and what is odd and still ordinary
- oracle: how far an effect stands out, and what cannot be told from it
- cases, truth, files: draw a case, write what an honest user has
- plans: which cases are run, and the frozen set
- judge, table, reliability: one answer against the truth, all of them as rates with their
  intervals, and whether stated probabilities hold
"""
