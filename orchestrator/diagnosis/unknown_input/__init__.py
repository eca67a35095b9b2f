"""Estimate the input that a model lacks, place by place, and read its law.

Owns: the state form of a system of FMUs, the smoother with an unknown input, the ranking of places, the law
library and the judgement on held-out runs. `inquiry` runs all steps: `search` fits laws stage by stage,
`choice` picks one, `verdict` decides whether it is the answer, and `answer` states what is known about it.
"""
