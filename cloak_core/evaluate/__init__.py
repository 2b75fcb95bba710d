"""How well a cloak works: success rates, experiments, reports."""
