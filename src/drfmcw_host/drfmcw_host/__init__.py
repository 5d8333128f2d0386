"""The host: a web page that shows the running graph, configures the stations and handles recordings."""
