"""Random input for calls and configuration files: each gives a result or a refusal in one sentence."""
