"""Files of attitudes: logs as tables, and those of CCSDS and SPICE."""
