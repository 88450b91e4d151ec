"""Trainings that are killed at any moment and resumed, compared with unbroken ones, bit by bit."""
