"""Input of every kind, by the thousand: each ends in a result or in one sentence."""
