"""Parts of the analysis of a heated winding: what a record holds, the network behind it, what that is worth."""
