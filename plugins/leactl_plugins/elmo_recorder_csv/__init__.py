"""Recordings of Elmo drives by the text files that the maker's tool saves."""
