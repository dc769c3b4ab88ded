"""Compilation of user-written steps in C++, and its cache."""
