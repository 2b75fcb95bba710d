"""Trainings on bodies and people: their material, their record, and how they begin."""
