"""Diagnosis of a docking rig: its catalogue of effects, its models, the weighing, the page, blind challenges.

`diagnose` goes through a case: `study` and `checks` read it, `weigh` finds the effects, further analyses say
where the gap arises, how far it closes and what to run next, and `report` writes the page.
"""
