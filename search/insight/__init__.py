"""What a search has learnt, for people: slices of its surrogates, which parameters matter, the best setting.

Nothing here decides anything. It takes a space, features and a record, and gives arrays; what is fitted is the same as
the strategies fit, so that people see what the search sees.
"""
