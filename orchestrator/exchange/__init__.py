"""Systems in and out of other tools."""
