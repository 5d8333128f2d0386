"""The survey of a site: a recording of the crane's travel and the customer's requirements come in, a report goes out.

The report says where the link is weak, disturbed or wrong, and whether each requirement is met.
"""
