"""What the pipeline knows of a pad: its baseline, what a touch was like, how old its frames are."""
