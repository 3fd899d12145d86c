"""Safety critics: V_c and Q_c of a policy, and of the best one.

conventions  the readings of the paper's equations
discount     what each reading is as a power of gamma
bellman      value_iteration and evaluate_policy: their equations are set up
expectile    the critic that the paper trains, likewise
critic       the equations solved, and the solution in one of the conventions
values       the result: values with bounds
precision    what to say where rounded numbers do not decide
fixed_point  how the equations are solved
"""
