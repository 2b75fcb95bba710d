"""Defences that stand before a detector: `jpeg=75:SPEC`, nested as one likes (`jpeg=75:blur=1:SPEC`).

`table` lists them, `detector` puts one before a detector. Whoever trains against the whole attacks the defence, too:
what has a gradient gives it, and what has none passes it straight through (BPDA: Athalye et al., "Obfuscated gradients
give a false sense of security", ICML 2018).
"""
