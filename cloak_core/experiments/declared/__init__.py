"""One module per experiment, each with an `EXPERIMENT`; the module's name is the experiment's, with dashes."""
