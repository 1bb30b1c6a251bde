"""Experiments on simulated robots: robot, effects and excitation in, records out."""
