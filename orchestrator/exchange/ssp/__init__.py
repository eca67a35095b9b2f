"""System Structure and Parameterization (SSP), versions 1.0 and 2.0."""
