"""The paper's tables and figures, and experiments of our own, each as a function from a lab to an outcome.

`registry.run_experiment` runs one by name. Trainings and evaluations are shared between experiments by content hash.
"""
