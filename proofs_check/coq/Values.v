(** * Existence of V^pi and V*: limits of the expected discounted costs. *)
From Coq Require Import List Reals Lra Lia.
From DeadEnds Require Import Statements Sums FixedPoint.
Import ListNotations.
Open Scope R_scope.

Section Values.
Variable M : MDP.
Variables gamma vf : R.
Hypothesis D : Discount gamma vf.

Let g1 : 0 < gamma < 1 := proj1 D.

Lemma discounted_nonneg : forall c, 0 <= c -> 0 <= gamma * c.
Proof. intros c H. apply Rmult_le_pos; lra. Qed.

Lemma target_le : forall V W t, (forall s, V s <= W s) -> target M gamma V t <= target M gamma W t.
Proof.
  intros V W t H. unfold target. destruct (fail M t); [lra|]. apply Rmult_le_compat_l; [lra|apply H].
Qed.

Lemma target_range : forall V t, (forall s, 0 <= V s <= 1) -> 0 <= target M gamma V t <= 1.
Proof. intros V t H. unfold target. specialize (H t). destruct (fail M t); [lra|]. nra. Qed.

Lemma target_shift : forall V c t, 0 <= c ->
  target M gamma (fun s => V s + c) t <= target M gamma V t + gamma * c.
Proof. intros V c t H. unfold target. destruct (fail M t); [nra|lra]. Qed.

Lemma Q_le : forall V W s a, (forall t, V t <= W t) -> Q M gamma V s a <= Q M gamma W s a.
Proof. intros V W s a H. apply expect_le; [apply step_dist|]. intros t _. now apply target_le. Qed.

Lemma Q_ext : forall V W s a, (forall t, V t = W t) -> Q M gamma V s a = Q M gamma W s a.
Proof. intros V W s a H. apply Rle_antisym; apply Q_le; intro t; rewrite H; lra. Qed.

Lemma Q_shift : forall V c s a, 0 <= c ->
  Q M gamma (fun t => V t + c) s a <= Q M gamma V s a + gamma * c.
Proof.
  intros V c s a H. pose proof (step_dist M s a) as DS.
  rewrite <- (expect_const (step M s a) (gamma * c) DS). unfold Q. rewrite <- expect_plus.
  apply expect_le; auto. intros t _. now apply target_shift.
Qed.

Lemma Q_range : forall V s a, (forall t, 0 <= V t <= 1) -> 0 <= Q M gamma V s a <= 1.
Proof.
  intros V s a H. pose proof (step_dist M s a) as DS. split.
  - apply expect_ge; auto. intros t _. now apply target_range.
  - apply expect_le_const; auto. intros t _. now apply target_range.
Qed.

(** ** Policy evaluation *)
Section Evaluation.
Variable pi : Policy M.
Hypothesis Hpi : IsPolicy M pi.

Lemma backup_mono : forall V W, (forall s, V s <= W s) ->
  forall s, backup M gamma vf pi V s <= backup M gamma vf pi W s.
Proof.
  intros V W H s. unfold backup. destruct (fail M s); [lra|].
  apply expect_le; [apply Hpi|]. intros a _. now apply Q_le.
Qed.

Lemma backup_range : forall V, (forall s, 0 <= V s <= 1) -> forall s, 0 <= backup M gamma vf pi V s <= 1.
Proof.
  intros V H s. unfold backup. destruct (fail M s); [apply D|]. destruct (Hpi s) as [DP _]. split.
  - apply expect_ge; auto. intros a _. now apply Q_range.
  - apply expect_le_const; auto. intros a _. now apply Q_range.
Qed.

Lemma backup_shift : forall V c s, 0 <= c ->
  backup M gamma vf pi (fun t => V t + c) s <= backup M gamma vf pi V s + gamma * c.
Proof.
  intros V c s H. pose proof (discounted_nonneg c H). unfold backup. destruct (fail M s); [lra|]. destruct (Hpi s) as [DP _].
  rewrite <- (expect_const (pi s) (gamma * c) DP), <- expect_plus.
  apply expect_le; auto. intros a _. now apply Q_shift.
Qed.

Lemma backup_zero : forall s, 0 <= backup M gamma vf pi (fun _ => 0) s.
Proof. intro s. apply backup_range. intro t. lra. Qed.
Lemma backup_one : forall s, backup M gamma vf pi (fun _ => 1) s <= 1.
Proof. intro s. apply (backup_range (fun _ => 1)). intro t. lra. Qed.

Lemma cost_iterate : forall n s, iterate (backup M gamma vf pi) n s = cost M gamma vf pi n s.
Proof.
  induction n as [|n IH]; intro s; [reflexivity|].
  change (backup M gamma vf pi (iterate (backup M gamma vf pi) n) s
          = backup M gamma vf pi (cost M gamma vf pi n) s).
  apply Rle_antisym; apply backup_mono; intro t; rewrite IH; lra.
Qed.

Lemma value_iff : forall V, IsValue M gamma vf pi V <->
  (forall s, 0 <= V s <= 1) /\ forall s, V s = backup M gamma vf pi V s.
Proof.
  intro V.
  rewrite <- (limit_unique _ backup_mono backup_zero backup_one gamma g1 backup_shift V).
  split; intros H s; specialize (H s); (eapply limit_ext; [|exact H]); intro n;
    [symmetry|]; apply cost_iterate.
Qed.

Lemma value_exists : exists V, IsValue M gamma vf pi V.
Proof.
  exists (limit (backup M gamma vf pi) backup_mono backup_zero backup_one). intro s.
  apply (limit_ext (fun n => iterate (backup M gamma vf pi) n s)); [intro n; apply cost_iterate|].
  apply limit_cv.
Qed.

Lemma value_unique : forall V W, IsValue M gamma vf pi V -> IsValue M gamma vf pi W -> forall s, V s = W s.
Proof. intros V W HV HW s. exact (UL_sequence _ _ _ (HV s) (HW s)). Qed.
End Evaluation.

(** ** The optimal value *)
Definition greedy (q : State M -> Action M -> R) s : Action M :=
  proj1_sig (argmin_list (q s) (actions M s) (actions_some M s)).

Lemma greedy_argmin : forall q s, Argmin M q s (greedy q s).
Proof. intros q s. unfold greedy. destruct (argmin_list _ _ _) as [a Ha]. exact Ha. Qed.

Lemma pure_policy : forall choose, (forall s, avail M s (choose s)) -> IsPolicy M (pure M choose).
Proof.
  intros choose H s. split; [apply dirac_dist|]. intros a Ha. apply supp_dirac in Ha. subst a. apply H.
Qed.

Definition optimal_backup V s := if fail M s then vf else Q M gamma V s (greedy (Q M gamma V) s).

Lemma optimal_backup_le : forall V s a, fail M s = false -> avail M s a ->
  optimal_backup V s <= Q M gamma V s a.
Proof.
  intros V s a Hf Ha. unfold optimal_backup. rewrite Hf. now apply greedy_argmin.
Qed.

Lemma optimal_mono : forall V W, (forall s, V s <= W s) ->
  forall s, optimal_backup V s <= optimal_backup W s.
Proof.
  intros V W H s. destruct (fail M s) eqn:Hf; [unfold optimal_backup; rewrite Hf; lra|].
  apply Rle_trans with (1 := optimal_backup_le V s _ Hf (proj1 (greedy_argmin (Q M gamma W) s))).
  unfold optimal_backup. rewrite Hf. now apply Q_le.
Qed.

Lemma optimal_shift : forall V c s, 0 <= c ->
  optimal_backup (fun t => V t + c) s <= optimal_backup V s + gamma * c.
Proof.
  intros V c s H. pose proof (discounted_nonneg c H).
  destruct (fail M s) eqn:Hf; [unfold optimal_backup; rewrite Hf; lra|].
  apply Rle_trans with (1 := optimal_backup_le _ s _ Hf (proj1 (greedy_argmin (Q M gamma V) s))).
  unfold optimal_backup. rewrite Hf. now apply Q_shift.
Qed.

Lemma optimal_zero : forall s, 0 <= optimal_backup (fun _ => 0) s.
Proof.
  intro s. unfold optimal_backup. destruct (fail M s); [apply D|]. apply Q_range. intro t. lra.
Qed.
Lemma optimal_one : forall s, optimal_backup (fun _ => 1) s <= 1.
Proof.
  intro s. unfold optimal_backup. destruct (fail M s); [apply D|]. apply (Q_range (fun _ => 1)). intro t. lra.
Qed.

Definition Vstar := limit optimal_backup optimal_mono optimal_zero optimal_one.

Definition Bellman (V : State M -> R) :=
  (forall s, 0 <= V s <= 1) /\ (forall s, fail M s = true -> V s = vf) /\
  forall s, fail M s = false -> (forall a, avail M s a -> V s <= Q M gamma V s a) /\
                                exists a, avail M s a /\ V s = Q M gamma V s a.

Lemma bellman_iff : forall V, Bellman V <->
  (forall s, 0 <= V s <= 1) /\ forall s, V s = optimal_backup V s.
Proof.
  intro V. split.
  - intros [B [F H]]. split; auto. intro s. destruct (fail M s) eqn:Hf.
    + unfold optimal_backup. rewrite Hf. auto.
    + destruct (H s Hf) as [L [a [Ha E]]]. apply Rle_antisym.
      * unfold optimal_backup. rewrite Hf. apply L, greedy_argmin.
      * pose proof (optimal_backup_le V s a Hf Ha). lra.
  - intros [B E]. split; auto. split; intros s Hf.
    + rewrite E. unfold optimal_backup. now rewrite Hf.
    + split.
      * intros a Ha. rewrite (E s). now apply optimal_backup_le.
      * exists (greedy (Q M gamma V) s). split; [apply greedy_argmin|].
        rewrite (E s) at 1. unfold optimal_backup. now rewrite Hf.
Qed.

Lemma Vstar_fixed : forall s, optimal_backup Vstar s = Vstar s.
Proof. exact (limit_fixed _ optimal_mono optimal_zero optimal_one gamma g1 optimal_shift). Qed.

Lemma Vstar_range : forall s, 0 <= Vstar s <= 1.
Proof. intro s. apply limit_range. Qed.

Lemma Vstar_bellman : Bellman Vstar.
Proof. apply bellman_iff. split; [apply Vstar_range|]. intro s. now rewrite Vstar_fixed. Qed.

Lemma bellman_unique : forall V, Bellman V -> forall s, V s = Vstar s.
Proof.
  intros V H s. apply bellman_iff in H.
  pose proof (proj2 (limit_unique _ optimal_mono optimal_zero optimal_one gamma g1 optimal_shift V) H) as C.
  exact (UL_sequence _ _ _ (C s) (limit_cv _ optimal_mono optimal_zero optimal_one s)).
Qed.

Lemma Vstar_optimal : IsOptimal M gamma vf Vstar.
Proof.
  split.
  - intros pi V Hpi HV. apply value_iff in HV; auto. destruct HV as [B E].
    apply limit_least; [intro s; apply B|]. intro s. rewrite (E s). unfold backup.
    destruct (fail M s) eqn:Hf; [unfold optimal_backup; rewrite Hf; lra|].
    apply expect_ge; [apply Hpi|]. intros a Ha. apply optimal_backup_le; auto. now apply Hpi.
  - set (rec := greedy (Q M gamma Vstar)).
    assert (Hrec : IsPolicy M (pure M rec)) by (apply pure_policy; intro s; apply greedy_argmin).
    exists (pure M rec). split; auto. apply value_iff; auto. split; [apply Vstar_range|].
    intro s. rewrite <- (Vstar_fixed s) at 1. unfold optimal_backup, backup.
    destruct (fail M s); auto. unfold pure. now rewrite expect_dirac.
Qed.

Lemma optimal_unique : forall V W, IsOptimal M gamma vf V -> IsOptimal M gamma vf W -> forall s, V s = W s.
Proof.
  intros V W [LV [p [Hp Vp]]] [LW [q [Hq Wq]]] s. apply Rle_antisym; [now apply (LV q)|now apply (LW p)].
Qed.

Lemma optimal_iff : forall V, IsOptimal M gamma vf V <-> Bellman V.
Proof.
  intro V. split; intro H.
  - pose proof (optimal_unique _ _ H Vstar_optimal) as E. apply bellman_iff. split.
    + intro s. rewrite E. apply Vstar_range.
    + intro s. rewrite E, <- Vstar_fixed. apply Rle_antisym; apply optimal_mono; intro t; rewrite E; lra.
  - pose proof (bellman_unique V H) as E. destruct Vstar_optimal as [L [p [Hp Vp]]]. split.
    + intros pi Vpi Hpi HVpi s. rewrite E. now apply (L pi).
    + exists p. split; auto. intro s. rewrite E. apply Vp.
Qed.
End Values.
