"""The one-way broadcast: its dialect, frames, codecs, signatures, and which frames are believed."""
