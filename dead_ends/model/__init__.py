"""Definition 1: a safe MDP.

safe_mdp           SafeMDP, its geometry, and its constructors
checks             what is wrong with a model, said in one sentence
transition_matrix  P[s, a, s'] as one sparse matrix
policy_table       policies as input: one action a state, or a distribution
digest             what tells a model from another
memory             whether a computation fits the machine
"""
