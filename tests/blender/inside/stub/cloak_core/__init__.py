"""A stand-in for the trainer that answers the command lines the add-on uses, in milliseconds."""

__version__ = "0.stub"
