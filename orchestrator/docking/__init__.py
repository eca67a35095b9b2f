"""The docking experiments: measures per contact, theory of the ideal contact, figures."""
