"""The mock's side of MAVLink: transports, links, streams, messages."""
