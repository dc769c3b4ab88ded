"""All compiled code and its calls: flows of blocks, loops over steps, recording, and ensembles."""
