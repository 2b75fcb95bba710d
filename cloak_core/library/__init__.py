"""Training and evaluation as one call each: for notebooks and programs, and for the commands, which call the same.

Nothing of the process is changed: no number of threads, no seed, no logging, no signal handler that stays. Everything
may be called twice, and from any thread.
"""
