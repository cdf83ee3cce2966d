"""The one-way broadcast: dialect, frames, codecs, signatures and the authenticator of received frames."""
