"""T-Rot: a home service robot with 24 components on two computers."""
