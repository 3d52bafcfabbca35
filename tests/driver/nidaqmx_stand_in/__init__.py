"""A stand-in for NI's libnidaqmx.so, built by the tests, and the program that runs the driver on it in a process."""
