"""The controller: real-time-iteration MPC, learned models in it, and whether they still fit."""
