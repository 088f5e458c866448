"""When the detector's probability begins a touch, and keeps it going: three numbers."""

# A touch begins after some frames above this probability, or one that is sure.
TOUCH, BEGIN_FRAMES, SURE = 0.7, 4, 0.985
# It goes on while the probability is above this, and for `quiet_s` below.
GOES_ON = 0.2
# Half a second of the untouched pad shows its rest.
REST_FRAMES = 27
