"""Robots that are simulated through an experiment, compared with each other.

`records`: which positions fit, decide and judge. `fitted`: a robot's numbers, fitted. `candidates`, `rank`,
`shortlist`: which effects are tried. `hypothesis`: one of them as numbers of which nothing is known. `judge`: whether
one robot is better than another. `one_round`, `selection`: effect by effect. `conclude`, `assemble`: what is said.
"""
