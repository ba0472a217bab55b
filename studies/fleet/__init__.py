"""A folder of logs of many vehicles: each flight diagnosed once, and what changes from flight to flight."""
