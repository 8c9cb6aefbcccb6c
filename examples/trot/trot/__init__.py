"""T-Rot: a home service robot with 25 components on two computers."""
