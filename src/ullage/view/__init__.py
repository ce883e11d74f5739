"""For eyes: figures, report, viewer."""
