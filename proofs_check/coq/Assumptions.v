(** * Each theorem has the type of its statement, and rests on these axioms.

    kernel.py reads the output. *)
From DeadEnds Require Statements CheckerStatements Theorems CheckerTheorems.

Check (Theorems.Partition : Statements.Partition_statement).
Print Assumptions Theorems.Partition.

Check (Theorems.Horizon : Statements.Horizon_statement).
Print Assumptions Theorems.Horizon.

Check (Theorems.Acyclic : Statements.Acyclic_statement).
Print Assumptions Theorems.Acyclic.

Check (Theorems.SurvivalTime : Statements.SurvivalTime_statement).
Print Assumptions Theorems.SurvivalTime.

Check (Theorems.MemorylessDead : Statements.MemorylessDead_statement).
Print Assumptions Theorems.MemorylessDead.

Check (Theorems.Threshold : Statements.Threshold_statement).
Print Assumptions Theorems.Threshold.

Check (Theorems.Value_exists : Statements.Value_exists_statement).
Print Assumptions Theorems.Value_exists.

Check (Theorems.Optimal_exists : Statements.Optimal_exists_statement).
Print Assumptions Theorems.Optimal_exists.

Check (Theorems.Lemma1_bullet1 : Statements.Lemma1_bullet1_statement).
Print Assumptions Theorems.Lemma1_bullet1.

Check (Theorems.Lemma1_bullet2 : Statements.Lemma1_bullet2_statement).
Print Assumptions Theorems.Lemma1_bullet2.

Check (Theorems.Lemma1_bullet3 : Statements.Lemma1_bullet3_statement).
Print Assumptions Theorems.Lemma1_bullet3.

Check (Theorems.Positive_value : Statements.Positive_value_statement).
Print Assumptions Theorems.Positive_value.

Check (Theorems.Theorem2_task : Statements.Theorem2_task_statement).
Print Assumptions Theorems.Theorem2_task.

Check (Theorems.Theorem2_recovery : Statements.Theorem2_recovery_statement).
Print Assumptions Theorems.Theorem2_recovery.

Check (Theorems.Theorem2 : Statements.Theorem2_statement).
Print Assumptions Theorems.Theorem2.

Check (Theorems.Exactness : Statements.Exactness_statement).
Print Assumptions Theorems.Exactness.

Check (Theorems.Tightness : Statements.Tightness_statement).
Print Assumptions Theorems.Tightness.

Check (Theorems.RRL_refuted : Statements.RRL_refuted_statement).
Print Assumptions Theorems.RRL_refuted.

Check (Theorems.RRL_repaired : Statements.RRL_repaired_statement).
Print Assumptions Theorems.RRL_repaired.

Check (Theorems.SelfReference : Statements.SelfReference_statement).
Print Assumptions Theorems.SelfReference.

Check (Theorems.Learned : Statements.Learned_statement).
Print Assumptions Theorems.Learned.

Check (Theorems.Expectile : Statements.Expectile_statement).
Print Assumptions Theorems.Expectile.

Check (Theorems.Theorem1 : Statements.Theorem1_statement).
Print Assumptions Theorems.Theorem1.

Check (Theorems.OneStep : Statements.OneStep_statement).
Print Assumptions Theorems.OneStep.

Check (Theorems.MinFailure_exists : Statements.MinFailure_exists_statement).
Print Assumptions Theorems.MinFailure_exists.

Check (Theorems.Qualitative : Statements.Qualitative_statement).
Print Assumptions Theorems.Qualitative.

Check (Theorems.ZeroSet : Statements.ZeroSet_statement).
Print Assumptions Theorems.ZeroSet.

Check (Theorems.Geometric : Statements.Geometric_statement).
Print Assumptions Theorems.Geometric.

Check (Theorems.Stochastic_refuted : Statements.Stochastic_refuted_statement).
Print Assumptions Theorems.Stochastic_refuted.

Check (CheckerTheorems.Labelling : CheckerStatements.Labelling_statement).
Print Assumptions CheckerTheorems.Labelling.

Check (CheckerTheorems.Certificate_deterministic : CheckerStatements.Certificate_deterministic_statement).
Print Assumptions CheckerTheorems.Certificate_deterministic.

Check (CheckerTheorems.Certificate_graph : CheckerStatements.Certificate_graph_statement).
Print Assumptions CheckerTheorems.Certificate_graph.

Check (CheckerTheorems.Certificate_probability : CheckerStatements.Certificate_probability_statement).
Print Assumptions CheckerTheorems.Certificate_probability.
