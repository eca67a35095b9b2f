"""Blind checks: a rig of its own that makes cases with hidden effects, sealed truths, scores of verdicts."""
