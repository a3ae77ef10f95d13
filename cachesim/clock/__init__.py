"""A run in cycles: the machine of the paper's Figure 1, and how long its rays take."""
