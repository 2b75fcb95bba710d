"""The paper's tables and figures, and experiments of our own.

An experiment is a module of three plain stages: `measure(lab)` trains and evaluates and returns `Numbers`, which are
written to a file; `draw(numbers)` makes figures of what that file holds, `tell(numbers)` sentences. `TITLE` names it,
`PAPER`, where it is there, holds the paper's values. `registry` runs one by name, or draws and tells it again.
Trainings and evaluations are shared between experiments by content hash.
"""
