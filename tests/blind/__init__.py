"""Blind trials: a laboratory of its own (closed form, numpy only), concealed physics in it, and a
judge.

Nothing here imports the product: it is run as a command on copies of a recording and a scenario,
and its answers are read from files. What is concealed is written down only after the answer is in.

    rotations, motion       turning and moving laboratory              rigs, sequences and ordinary
    sensors of the seven kinds of set-up world, memory           from motion to readings, with hooks
    for physics that the scenario does not state mechanics, sensing, electronics, faults      what
    the catalogue lists unlisted                what it does not noise, oracle           how far an
    effect stands out, and what cannot be told from it cases, files            draw a case, write
    what an honest user has judge, table            one answer against the truth, all of them as
    rates with their intervals
"""
