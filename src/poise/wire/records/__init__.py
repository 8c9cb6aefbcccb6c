"""The records that programs exchange."""
