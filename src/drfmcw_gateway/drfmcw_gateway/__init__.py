"""Ranges for crane controllers: range topics in, OPC UA and Modbus TCP servers out."""
