"""Driver for recordings of Elmo drives, read from the text files that the maker's tool saves."""
