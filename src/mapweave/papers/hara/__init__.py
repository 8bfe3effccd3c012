"""Hara, Kawata, Ohya, Yuta: a 200 m loop mapped with received light intensity."""
