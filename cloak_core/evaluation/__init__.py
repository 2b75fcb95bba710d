"""How well a cloak works: rates, controls, intervals, experiments, reports."""
