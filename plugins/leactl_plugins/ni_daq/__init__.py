"""NI multifunction converters through NI-DAQmx."""
