"""Korad's bench supplies KA3003P to KA6005P over their serial line, under their own and under other makers' names."""
