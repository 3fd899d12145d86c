"""Theorems 1 and 2: thresholds, recovery policies, behavior correction, and what they promise.

critics             what a decision is taken on: values with bounds, or a table without
thresholds          the thresholds that separate safe from unsafe actions
policies            allowed actions, policy sets, recovery policies
correction          behavior correction, and the corrected task as a model
filter_table        a safety filter as a file
tabular_correction  the filter around a Gymnasium environment
planning            the best return behind the filter, and the price of a worse critic
guarantees          what remains true in stochastic models
explanation         why a state is lost, by witness
"""
