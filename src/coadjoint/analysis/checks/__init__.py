"""What is looked at by a certificate? One file for each kind of check."""
