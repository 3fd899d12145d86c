(** * Finite distributions: expectation is linear, monotone, and decided by the support. *)
From Coq Require Import List Reals Lra Psatz.
From DeadEnds Require Import Statements.
Import ListNotations.
Open Scope R_scope.

Section Expectation.
Context {A : Type}.
Implicit Types (d : Dist A) (f h : A -> R).

Lemma expect_cons : forall p x d f, expect ((p, x) :: d) f = p * f x + expect d f.
Proof. reflexivity. Qed.

Lemma total_cons : forall {B} (o : B) l (f : B -> R), total (o :: l) f = f o + total l f.
Proof. reflexivity. Qed.

Lemma expect_ext : forall d f h, (forall x, f x = h x) -> expect d f = expect d h.
Proof.
  intros d f h E. induction d as [|[p x] d IH]; [reflexivity|]. now rewrite !expect_cons, IH, E.
Qed.

Lemma expect_plus : forall d f h, expect d (fun x => f x + h x) = expect d f + expect d h.
Proof.
  intros d f h. induction d as [|[p x] d IH]; [cbn; lra|]. rewrite !expect_cons, IH. lra.
Qed.

Lemma expect_scal : forall d c f, expect d (fun x => c * f x) = c * expect d f.
Proof.
  intros d c f. induction d as [|[p x] d IH]; [cbn; lra|]. rewrite !expect_cons, IH. lra.
Qed.

Lemma expect_const : forall d c, IsDist d -> expect d (fun _ => c) = c.
Proof.
  intros d c [_ T].
  assert (E : expect d (fun _ => c) = c * total d fst).
  { clear T. induction d as [|[p x] d IH]; [cbn; lra|].
    rewrite expect_cons, IH, total_cons. cbn [fst]. lra. }
  rewrite E, T. lra.
Qed.

Lemma expect_dirac : forall x f, expect (dirac x) f = f x.
Proof. intros x f. unfold dirac. rewrite expect_cons. cbn. lra. Qed.

Lemma dirac_dist : forall x : A, IsDist (dirac x).
Proof. intro x. split; [intros o [<-|[]]; cbn; lra|cbn; lra]. Qed.

Lemma supp_dirac : forall x y : A, Supp (dirac x) y <-> y = x.
Proof.
  intros x y. split.
  - intros [p [_ [E|[]]]]. congruence.
  - intros ->. exists 1. split; [lra|now left].
Qed.

Lemma expect_le : forall d f h, IsDist d -> (forall x, Supp d x -> f x <= h x) ->
  expect d f <= expect d h.
Proof.
  intros d f h [P _] H.
  assert (G : forall d', incl d' d -> expect d' f <= expect d' h).
  { induction d' as [|[p x] d' IH]; intro I; [cbn; lra|]. rewrite !expect_cons.
    assert (Hp : 0 <= p) by (apply (P (p, x)), I; now left).
    specialize (IH (fun o Ho => I o (or_intror Ho))).
    destruct Hp as [Hp|<-]; [|lra].
    assert (f x <= h x) by (apply H; exists p; split; auto; apply I; now left).
    assert (p * f x <= p * h x) by (apply Rmult_le_compat_l; lra). lra. }
  apply G. intros o Ho. exact Ho.
Qed.

Lemma expect_ext_supp : forall d f h, IsDist d -> (forall x, Supp d x -> f x = h x) ->
  expect d f = expect d h.
Proof.
  intros d f h D H. apply Rle_antisym; apply expect_le; auto; intros x Hx; rewrite H; auto; lra.
Qed.

Lemma expect_ge : forall d f c, IsDist d -> (forall x, Supp d x -> c <= f x) -> c <= expect d f.
Proof.
  intros d f c D H. rewrite <- (expect_const d c D). now apply expect_le.
Qed.

Lemma expect_le_const : forall d f c, IsDist d -> (forall x, Supp d x -> f x <= c) -> expect d f <= c.
Proof.
  intros d f c D H. rewrite <- (expect_const d c D). now apply expect_le.
Qed.

Lemma supp_some : forall d, IsDist d -> exists x, Supp d x.
Proof.
  intros d [P T].
  assert (G : forall d', incl d' d -> total d' fst <= 0 \/ exists x, Supp d x).
  { induction d' as [|[p x] d' IH]; intro I; [left; cbn; lra|].
    assert (Hp : 0 <= p) by (apply (P (p, x)), I; now left).
    destruct (IH (fun o Ho => I o (or_intror Ho))) as [L|X]; auto.
    destruct Hp as [Hp|<-].
    - right. exists x, p. split; auto. apply I. now left.
    - left. rewrite total_cons. cbn [fst]. lra. }
  destruct (G d (fun o Ho => Ho)) as [L|X]; auto. lra.
Qed.

(** A nonnegative function with expectation 0 vanishes on the support. *)
Lemma expect_zero : forall d f, IsDist d -> (forall x, 0 <= f x) -> expect d f = 0 ->
  forall x, Supp d x -> f x = 0.
Proof.
  intros d f [P _] H Z x [p [Hp Hin]].
  assert (G : forall d', incl d' d -> 0 <= expect d' f).
  { induction d' as [|[q y] d' IH]; intro I; [cbn; lra|]. rewrite expect_cons.
    assert (0 <= q) by (apply (P (q, y)), I; now left).
    specialize (IH (fun o Ho => I o (or_intror Ho))).
    assert (0 <= q * f y) by (apply Rmult_le_pos; auto). lra. }
  assert (B : forall d', incl d' d -> In (p, x) d' -> p * f x <= expect d' f).
  { induction d' as [|[q y] d' IH]; intros I Hin'; [destruct Hin'|]; rewrite expect_cons;
      destruct Hin' as [E|Hin'].
    - injection E as <- <-. pose proof (G d' (fun o Ho => I o (or_intror Ho))). lra.
    - specialize (IH (fun o Ho => I o (or_intror Ho)) Hin').
      assert (0 <= q) by (apply (P (q, y)), I; now left).
      assert (0 <= q * f y) by (apply Rmult_le_pos; auto). lra. }
  specialize (B d (fun o Ho => Ho) Hin). specialize (H x).
  destruct H as [H|H]; auto. assert (0 < p * f x) by now apply Rmult_lt_0_compat. lra.
Qed.

Lemma expect_strict : forall d f c x, IsDist d -> (forall y, f y <= c) -> Supp d x -> f x < c ->
  expect d f < c.
Proof.
  intros d f c x D H Hx Lt. pose proof (expect_le_const d f c D (fun y _ => H y)) as [L|E]; auto.
  exfalso. assert (Z : expect d (fun y => c + - 1 * f y) = 0).
  { rewrite expect_plus, expect_const, expect_scal, E; auto. lra. }
  assert (P : forall y, 0 <= c + - 1 * f y) by (intro y; specialize (H y); lra).
  pose proof (expect_zero d _ D P Z x Hx) as X. cbn in X. lra.
Qed.

Lemma argmin_list : forall (f : A -> R) (l : list A), l <> [] ->
  {x | In x l /\ forall y, In y l -> f x <= f y}.
Proof.
  intros f [|a l] N; [congruence|]. clear N. revert a. induction l as [|b l IH]; intro a.
  - exists a. split; [now left|]. intros y [<-|[]]. lra.
  - destruct (IH b) as [x [Hx Lx]]. destruct (Rle_lt_dec (f a) (f x)) as [L|L].
    + exists a. split; [now left|]. intros y [<-|Hy]; [lra|]. specialize (Lx y Hy). lra.
    + exists x. split; [now right|]. intros y [<-|Hy]; [lra|]. now apply Lx.
Qed.
End Expectation.

Lemma bounded_list : forall {A} (f : A -> R) (l : list A), exists C, 0 <= C /\ forall x, In x l -> f x <= C.
Proof.
  intros A f l. induction l as [|a l [C [C0 H]]].
  - exists 0. split; [lra|intros x []].
  - exists (Rmax C (f a)). pose proof (Rmax_l C (f a)). pose proof (Rmax_r C (f a)).
    split; [lra|]. intros x [<-|Hx]; [lra|]. specialize (H x Hx). lra.
Qed.

(** A discount g < 1 leaves nothing: x <= C g^k for all k means x <= 0. *)
Lemma discount_vanishes : forall g C x, 0 < g < 1 -> 0 <= C -> (forall k, x <= C * g ^ k) -> x <= 0.
Proof.
  intros g C x Hg HC H. destruct (Rle_lt_dec x 0) as [|P]; auto. exfalso.
  destruct (Rle_lt_or_eq_dec 0 C HC) as [Cp|<-]; [|specialize (H 0%nat); lra].
  assert (Y : 0 < x / C) by (apply Rdiv_lt_0_compat; lra).
  destruct (pow_lt_1_zero g ltac:(rewrite Rabs_pos_eq; lra) (x / C) Y) as [k Hk].
  specialize (Hk k (le_n k)). assert (0 < g ^ k) by (apply pow_lt; lra).
  rewrite Rabs_pos_eq in Hk by lra. specialize (H k).
  assert (C * g ^ k < C * (x / C)) by (apply Rmult_lt_compat_l; lra).
  replace (C * (x / C)) with x in H1 by (field; lra). lra.
Qed.

Lemma pow_unit : forall g n, 0 < g < 1 -> 0 < g ^ n <= 1.
Proof.
  intros g n Hg. split; [apply pow_lt; lra|]. rewrite <- (pow1 n). apply pow_incr. lra.
Qed.

Lemma pow_antitone : forall g m n, 0 < g < 1 -> (m <= n)%nat -> g ^ n <= g ^ m.
Proof.
  intros g m n Hg H. induction H as [|n H IH]; [lra|]. cbn. pose proof (pow_unit g n Hg). nra.
Qed.

Lemma pow_antitone_inv : forall g m n, 0 < g < 1 -> g ^ n <= g ^ m -> (m <= n)%nat.
Proof.
  intros g m n Hg H. destruct (Compare_dec.le_lt_dec m n) as [|L]; auto. exfalso.
  pose proof (pow_antitone g (S n) m Hg L) as B. cbn in B. pose proof (pow_unit g n Hg). nra.
Qed.
