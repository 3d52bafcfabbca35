"""The contract of driver plug-ins, the wires they may use, and the registry that finds them."""
