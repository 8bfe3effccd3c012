"""Kojima, Okawa, Namerikawa: two e-pucks, eight landmarks, maps merged through relative information."""
