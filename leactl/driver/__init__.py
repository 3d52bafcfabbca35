"""The contract a driver plug-in fulfils, the wires it may use, and the registry that finds plug-ins."""
