"""Many tasks: processes that may be lost, engines that spread tasks over them, and a journal of
what is finished.
"""
