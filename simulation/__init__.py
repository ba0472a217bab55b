"""The runtime on the mock's vehicle in simulated time: lockstep, the paper's campaign, the check of a bundle."""
