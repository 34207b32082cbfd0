"""The version, alone in a file so that building needs no import."""

VERSION = "0.1.0"
