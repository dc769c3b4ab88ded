"""The protocol of schemes, and base classes for each kind."""
