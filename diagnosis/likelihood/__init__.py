"""The likelihood of flights: one linearised model, its filter's innovations, and what every candidate changes there."""
