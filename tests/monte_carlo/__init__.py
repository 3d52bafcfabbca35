"""Random protocols on random plants under the real supervisor: does the guard hold, and what does it cost?"""
