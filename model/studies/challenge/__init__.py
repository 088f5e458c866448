"""The systems of the 2015 touch challenge, reimplemented: table 1 of the paper."""
