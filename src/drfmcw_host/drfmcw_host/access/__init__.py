"""Who may do what.

In: requests, passwords, cookies.
Out: a session or a refusal; one line of the audit log per action.
"""
