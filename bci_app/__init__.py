"""Closed-loop ErrP-based shared autonomy: the core that stimulus, decoder and policy share."""

__version__ = "0.1.0"
