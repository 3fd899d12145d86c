(** * Theorem 2 fails with chance, for every threshold.

    In Ok one action stays, the other fails with probability p = eps/2.  Ok is perfectly
    safe (X = 0), yet the gate allows the second action at every step. *)
From Coq Require Import List Reals Lra Lia.
From DeadEnds Require Import Statements Sums FixedPoint Values Stochastic.
Import ListNotations.
Open Scope R_scope.

Section Gamble.
Variable eps : R.
Hypothesis He : 0 < eps < 1.

Inductive Spot := Ok | Lost.
Lemma spots_all : forall s, In s [Ok; Lost]. Proof. intros []; cbn; tauto. Qed.
Definition gamble_actions (_ : Spot) := [true; false].
Lemma gamble_some : forall s, gamble_actions s <> []. Proof. discriminate. Qed.
Definition p := eps / 2.
Definition gamble_step (s : Spot) (risky : bool) : Dist Spot :=
  match s, risky with Ok, true => [(p, Lost); (1 - p, Ok)] | _, _ => dirac s end.
Lemma gamble_dist : forall s a, IsDist (gamble_step s a).
Proof.
  intros [] []; try apply dirac_dist. split; [|cbn; lra].
  intros o [<-|[<-|[]]]; cbn; unfold p; lra.
Qed.
Definition lost s := match s with Lost => true | Ok => false end.
Definition gamble : MDP :=
  {| State := Spot; Action := bool; states := [Ok; Lost]; states_all := spots_all;
     actions := gamble_actions; actions_some := gamble_some; step := gamble_step;
     step_dist := gamble_dist; fail := lost |}.

Lemma gamble_avail : forall s a, avail gamble s a.
Proof. intros s []; cbn; tauto. Qed.

Definition X := Pmin gamble.

Lemma X_lost : X Lost = 1.
Proof. apply (X_fail gamble X (Pmin_min gamble)). reflexivity. Qed.

Lemma X_ok : X Ok = 0.
Proof.
  apply (zero_avoidable gamble X (Pmin_min gamble)). exists (fun s => s = Ok). split; auto.
  intros t ->. split; [reflexivity|]. exists false. split; [apply gamble_avail|].
  intros u Hu. now apply supp_dirac in Hu.
Qed.

Definition always_risky : HistoryPolicy gamble := fun _ => pure gamble (fun _ => true).

Lemma gamble_surviving : forall rec n past,
  surviving gamble X eps rec always_risky n past Ok = (1 - p) ^ n.
Proof.
  intros rec. induction n as [|n IH]; intro past; [reflexivity|].
  cbn [surviving gamble fail lost]. unfold always_risky, pure. rewrite expect_dirac.
  assert (C : corrected gamble X eps rec Ok true = true).
  { unfold corrected, chance. cbn [step gamble gamble_step]. rewrite !expect_cons, X_lost, X_ok.
    destruct (Rlt_dec _ eps) as [|N]; auto. exfalso. apply N. cbn. unfold p. lra. }
  rewrite C. cbn [step gamble gamble_step]. rewrite !expect_cons.
  fold (pure gamble (fun _ => true)). change (fun _ : list (State gamble) => pure gamble (fun _ => true)) with always_risky.
  rewrite IH.
  assert (Z : surviving gamble X eps rec always_risky n (Ok :: past) Lost = 0) by (destruct n; reflexivity).
  change (p * surviving gamble X eps rec always_risky n (Ok :: past) Lost + ((1 - p) * (1 - p) ^ n + 0)
          = (1 - p) * (1 - p) ^ n).
  rewrite Z. ring.
Qed.
End Gamble.

Theorem stochastic_refuted : Stochastic_refuted_statement.
Proof.
  intros eps He. exists (gamble eps He), (X eps He), (greedy (gamble eps He) (chance (gamble eps He) (X eps He))),
    (always_risky eps He), Ok, (p eps).
  split; [apply Pmin_min|]. split; [intro t; apply greedy_argmin|].
  split; [intro past; apply pure_policy; intro s; apply gamble_avail|].
  split; [apply X_ok|]. split; [unfold p; lra|]. intro n. apply gamble_surviving.
Qed.
