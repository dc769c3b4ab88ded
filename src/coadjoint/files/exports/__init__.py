"""Code for programs in other languages."""
