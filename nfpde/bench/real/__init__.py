"""Recordings of real robots that others published: what the diagnosis makes of them, beside what is known of each."""
