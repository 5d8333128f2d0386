"""What nodes say to each other: names and QoS of topics, the message boundary, streams, who else publishes.

In: dataclasses, numbers and names of stations. Out: messages on topics, and dataclasses from messages.
"""
