"""An adversary of the thermal guard: looks for what makes a winding hotter than its bound."""
