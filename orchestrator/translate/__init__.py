"""Modelica and Python models to FMUs."""
