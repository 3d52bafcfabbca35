"""Parts of the analysis of a heated winding: records, the fit of the network, its uncertainty."""
