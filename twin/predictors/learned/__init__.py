"""Predictors that learn from data: VARX, LSTM, and networks trained on many boats.

May import twin.predictors and below.
"""
