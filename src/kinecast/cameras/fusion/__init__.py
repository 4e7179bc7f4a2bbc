"""Several cameras into one skeleton for each person."""
