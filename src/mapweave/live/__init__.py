"""A team that drives now: messages, transport, durable histories and the shared map."""
