"""The private MAVLink dialect of the one-way link: `oneway.xml`, and `oneway.py` generated from it.

Regenerate after a change of the XML with `python -m companion.protocol.dialect`; a test checks that the two agree. The
generated module needs nothing but the standard library (and fastcrc, if present).
"""
