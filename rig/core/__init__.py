"""The words every other room speaks: values, seams, units, errors, clocks."""
