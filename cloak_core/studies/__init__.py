"""What is asked of the core: each a list of trainings and measurements."""
