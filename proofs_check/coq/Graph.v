(** * Survival times by retrograde analysis, on any finite graph.

    [surv k s]: some path from [s] meets no fail state at times 0..k.  On a finite
    closed set of states the survival sets become constant, because the states on
    a longest path to failure have survival times n, n-1, ..., 1: all different.
    No axiom is used in this file. *)
From Coq Require Import List Arith Lia Bool.
From DeadEnds Require Import Statements.
Import ListNotations.

Section Retrograde.
Context {St : Type} (succs : St -> list St) (edge : St -> St -> Prop) (fail : St -> bool).
Variable U : list St.
Hypothesis edge_iff : forall s t, edge s t <-> In t (succs s).
Hypothesis closed : forall s t, In s U -> In t (succs s) -> In t U.
Hypothesis some_succ : forall s, In s U -> succs s <> [].

Fixpoint surv (k : nat) (s : St) : bool :=
  negb (fail s) && match k with O => true | S j => existsb (surv j) (succs s) end.

Lemma surv_succ : forall k s,
  surv (S k) s = true <-> fail s = false /\ exists t, In t (succs s) /\ surv k t = true.
Proof.
  intros k s. cbn [surv]. rewrite andb_true_iff, negb_true_iff, existsb_exists. reflexivity.
Qed.

Lemma surv_zero : forall s, surv 0 s = negb (fail s).
Proof. intro s. cbn. apply andb_true_r. Qed.

Lemma surv_alive : forall k s, surv k s = true -> fail s = false.
Proof. intros [|k] s H; cbn in H; apply andb_true_iff in H; now apply negb_true_iff. Qed.

Lemma surv_pred : forall k s, surv (S k) s = true -> surv k s = true.
Proof.
  induction k as [|k IH]; intros s H; apply surv_succ in H; destruct H as [Hf [t [Ht H]]].
  - rewrite surv_zero, Hf. reflexivity.
  - apply surv_succ. eauto.
Qed.

Lemma surv_le : forall j k s, j <= k -> surv k s = true -> surv j s = true.
Proof. intros j k s H. induction H; auto using surv_pred. Qed.

Lemma surv_false_le : forall j k s, j <= k -> surv j s = false -> surv k s = false.
Proof.
  intros j k s H E. destruct (surv k s) eqn:K; auto.
  rewrite (surv_le j k s H K) in E. discriminate.
Qed.

(** ** Survival times, as numbers *)
Definition lasts n s := surv n s = false /\ forall k, k < n -> surv k s = true.

Lemma lasts_fun : forall m n s, lasts m s -> lasts n s -> m = n.
Proof.
  intros m n s [Hm Lm] [Hn Ln]. destruct (lt_eq_lt_dec m n) as [[H|H]|H]; auto.
  - rewrite (Ln m H) in Hm. discriminate.
  - rewrite (Lm n H) in Hn. discriminate.
Qed.

Lemma lasts_exists : forall k s, surv k s = false -> exists n, n <= k /\ lasts n s.
Proof.
  induction k as [|k IH]; intros s H.
  - exists 0. repeat split; auto. intros; lia.
  - destruct (surv k s) eqn:E.
    + exists (S k). repeat split; auto. intros j Hj. apply (surv_le j k); auto. lia.
    + destruct (IH s E) as [n [Hn L]]. exists n. auto.
Qed.

Lemma lasts_zero : forall s, lasts 0 s <-> fail s = true.
Proof.
  intro s. unfold lasts. rewrite surv_zero, negb_false_iff. intuition lia.
Qed.

Lemma lasts_succ : forall n s, In s U -> (lasts (S n) s <-> fail s = false /\
  (forall t, In t (succs s) -> exists k, k <= n /\ lasts k t) /\ exists t, In t (succs s) /\ lasts n t).
Proof.
  intros n s Us. split.
  - intros [H L]. pose proof (surv_alive 0 s (L 0 (Nat.lt_0_succ n))) as Hf.
    assert (A : forall t, In t (succs s) -> surv n t = false).
    { intros t Ht. destruct (surv n t) eqn:E; auto.
      assert (X : surv (S n) s = true) by (apply surv_succ; eauto). congruence. }
    split; [exact Hf|]. split; [intros t Ht; apply lasts_exists; auto|].
    destruct n as [|n].
    + pose proof (some_succ s Us) as Ne. destruct (succs s) as [|t l]; [congruence|].
      exists t. split; [now left|]. split; [apply A; now left|]. intros; lia.
    + destruct (proj1 (surv_succ n s) (L (S n) (Nat.lt_succ_diag_r _))) as [_ [t [Ht E]]].
      exists t. split; auto. split; auto. intros k Hk. apply (surv_le k n); auto. lia.
  - intros [Hf [A [t [Ht [Hn L]]]]]. split.
    + destruct (surv (S n) s) eqn:E; auto. apply surv_succ in E. destruct E as [_ [u [Hu E]]].
      destruct (A u Hu) as [k [Hk [X _]]]. rewrite (surv_false_le k n u Hk X) in E. discriminate.
    + intros [|k] Hk; [now rewrite surv_zero, Hf|]. apply surv_succ. split; auto.
      exists t. split; auto. apply L. lia.
Qed.

(** A longest path to failure: n different states, with survival times n, ..., 1. *)
Lemma ladder : forall n s, In s U -> lasts n s -> exists l, length l = n /\ NoDup l /\
  forall t, In t l -> In t U /\ exists k, 1 <= k <= n /\ lasts k t.
Proof.
  induction n as [|n IH]; intros s Us L.
  - exists []. split; [reflexivity|]. split; [constructor|intros t []].
  - destruct (proj1 (lasts_succ n s Us) L) as [_ [_ [t [Ht Lt]]]].
    destruct (IH t (closed s t Us Ht) Lt) as [l [Hl [Nl Al]]].
    exists (s :: l). cbn. split; [now rewrite Hl|]. split.
    + constructor; auto. intro Hin. destruct (Al s Hin) as [_ [k [Hk Lk]]].
      pose proof (lasts_fun _ _ _ L Lk). lia.
    + intros u [<-|Hu]; [split; auto; exists (S n); split; auto; lia|].
      destruct (Al u Hu) as [Uu [k [Hk Lk]]]. split; auto. exists k. split; auto. lia.
Qed.

Definition safeb s := surv (length U) s.

Lemma lasts_bound : forall n s, In s U -> lasts n s -> n <= length U.
Proof.
  intros n s Us L. destruct (ladder n s Us L) as [l [Hl [Nl Al]]]. rewrite <- Hl.
  apply NoDup_incl_length; auto. intros t Ht. now apply Al.
Qed.

Lemma safeb_forever : forall s, In s U -> safeb s = true -> forall k, surv k s = true.
Proof.
  intros s Us H k. destruct (surv k s) eqn:E; auto.
  destruct (lasts_exists k s E) as [n [_ L]].
  pose proof (lasts_bound n s Us L) as B. destruct L as [L _].
  unfold safeb in H. rewrite (surv_false_le n (length U) s B L) in H. discriminate.
Qed.

Lemma safeb_lasts : forall s, In s U -> safeb s = false <-> exists n, lasts n s.
Proof.
  intros s Us. split.
  - intro H. destruct (lasts_exists _ _ H) as [n [_ L]]. eauto.
  - intros [n [L _]]. destruct (safeb s) eqn:E; auto.
    rewrite (safeb_forever s Us E n) in L. discriminate.
Qed.

Lemma safeb_succ : forall s, In s U -> safeb s = true -> exists t, In t (succs s) /\ safeb t = true.
Proof.
  intros s Us H. pose proof (safeb_forever s Us H (S (length U))) as X.
  apply surv_succ in X. tauto.
Qed.

(** ** Paths *)
Definition walk (pick : St -> St) (s : St) (i : nat) : St := Nat.iter i pick s.
Definition first (s : St) : St := hd s (succs s).

Lemma first_succ : forall s, In s U -> In (first s) (succs s).
Proof.
  intros s Us. pose proof (some_succ s Us). unfold first. destruct (succs s); [congruence|now left].
Qed.

Lemma walk_path : forall pick s (I : St -> Prop), I s ->
  (forall t, I t -> In (pick t) (succs t) /\ I (pick t)) ->
  IsPath edge (walk pick s) /\ forall i, I (walk pick s i).
Proof.
  intros pick s I Hs Hstep.
  assert (A : forall i, I (walk pick s i)) by (induction i as [|i IH]; [exact Hs|exact (proj2 (Hstep _ IH))]).
  split; auto. intro i. apply edge_iff. cbn. apply Hstep, A.
Qed.

Lemma path_cons : forall s w, edge s (w 0) -> IsPath edge w ->
  IsPath edge (fun i => match i with O => s | S j => w j end).
Proof. intros s w E P [|i]; [exact E|apply P]. Qed.

Lemma surv_path : forall k s, In s U -> surv k s = true ->
  exists w, IsPath edge w /\ w 0 = s /\ forall j, j <= k -> fail (w j) = false.
Proof.
  induction k as [|k IH]; intros s Us H.
  - destruct (walk_path first s (fun t => In t U) Us) as [P _].
    { intros t Ut. pose proof (first_succ t Ut). split; auto. now apply (closed t). }
    exists (walk first s). split; auto. split; auto. intros j Hj. replace j with 0 by lia.
    cbn. now apply (surv_alive 0).
  - destruct (proj1 (surv_succ k s) H) as [Hf [t [Ht Kt]]].
    destruct (IH t (closed s t Us Ht) Kt) as [w [P [W0 A]]].
    exists (fun i => match i with O => s | S j => w j end). split.
    + apply path_cons; auto. rewrite W0. now apply edge_iff.
    + split; auto. intros [|j] Hj; auto. apply A. lia.
Qed.

Lemma path_surv : forall k w, IsPath edge w -> (forall j, j <= k -> fail (w j) = false) ->
  surv k (w 0) = true.
Proof.
  induction k as [|k IH]; intros w P A.
  - rewrite surv_zero, A; auto.
  - apply surv_succ. split; [apply A; lia|]. exists (w 1). split; [apply edge_iff, P|].
    apply (IH (fun i => w (S i))); [intro i; apply P|]. intros j Hj. apply A. lia.
Qed.

Lemma first_failure : forall k (w : nat -> St),
  (forall j, j <= k -> fail (w j) = false) \/ exists j, j <= k /\ fail (w j) = true.
Proof.
  induction k as [|k IH]; intro w.
  - destruct (fail (w 0)) eqn:E; [right; eauto|left]. intros j Hj. now replace j with 0 by lia.
  - destruct (IH w) as [A|[j [Hj F]]]; [|right; eauto].
    destruct (fail (w (S k))) eqn:E; [right; eauto|left].
    intros j Hj. destruct (Nat.eq_dec j (S k)) as [->|]; auto. apply A. lia.
Qed.

Lemma forced_iff : forall k s, In s U -> ForcedWithin edge fail k s <-> surv k s = false.
Proof.
  intros k s Us. split.
  - intro F. destruct (surv k s) eqn:E; auto. destruct (surv_path k s Us E) as [w [P [W0 A]]].
    destruct (F w P W0) as [j [Hj Fj]]. rewrite A in Fj; auto.
  - intros E w P W0. destruct (first_failure k w) as [A|X]; auto.
    pose proof (path_surv k w P A) as X. rewrite W0 in X. congruence.
Qed.

Lemma time_iff : forall n s, In s U -> SurvivalTime edge fail s n <-> lasts n s.
Proof.
  intros n s Us. unfold SurvivalTime, lasts. rewrite forced_iff by auto. split; intros [H L]; split; auto.
  - intros k Hk. destruct (surv k s) eqn:E; auto. apply forced_iff in E; auto. apply L in E. lia.
  - intros m F. apply forced_iff in F; auto. destruct (le_lt_dec n m) as [|K]; auto.
    rewrite (L m K) in F. discriminate.
Qed.

Definition stay (s : St) : St := match find safeb (succs s) with Some t => t | None => s end.

Lemma stay_safe : forall s, In s U -> safeb s = true -> In (stay s) (succs s) /\ safeb (stay s) = true.
Proof.
  intros s Us H. unfold stay. destruct (find safeb (succs s)) as [t|] eqn:E.
  - now apply find_some in E.
  - destruct (safeb_succ s Us H) as [t [Ht St']]. pose proof (find_none _ _ E t Ht). congruence.
Qed.

Lemma safeb_path : forall s, In s U -> safeb s = true <->
  exists w, IsPath edge w /\ w 0 = s /\ forall k, fail (w k) = false.
Proof.
  intros s Us. split.
  - intro H. destruct (walk_path stay s (fun t => In t U /\ safeb t = true)) as [P A]; auto.
    { intros t [Ut Ht]. destruct (stay_safe t Ut Ht) as [Hin Hs]. split; auto. split; auto.
      now apply (closed t). }
    exists (walk stay s). split; auto. split; auto. intro k. apply (surv_alive (length U)), A.
  - intros [w [P [W0 A]]]. rewrite <- W0. apply path_surv; auto.
Qed.

Theorem dead_iff : forall s, In s U -> Dead edge fail s <-> fail s = false /\ safeb s = false.
Proof.
  intros s Us. split.
  - intros [Hf D]. split; auto. destruct (safeb s) eqn:E; auto.
    apply safeb_path in E; auto. destruct E as [w [P [W0 A]]].
    destruct (D w P W0) as [k Fk]. rewrite A in Fk. discriminate.
  - intros [Hf E]. split; auto. intros w P W0. apply safeb_lasts in E; auto. destruct E as [n L].
    apply time_iff in L; auto. destruct L as [F _]. destruct (F w P W0) as [k [_ Fk]]. eauto.
Qed.

Theorem safe_iff : forall s, In s U -> Safe edge fail s <-> safeb s = true.
Proof.
  intros s Us. unfold Safe. rewrite dead_iff by auto. split.
  - intros [Hf D]. destruct (safeb s) eqn:E; [reflexivity|exfalso; now apply D].
  - intro E. split; [now apply (surv_alive (length U))|]. intros [_ X]. congruence.
Qed.

Theorem partition : forall s, In s U -> fail s = true \/ Dead edge fail s \/ Safe edge fail s.
Proof.
  intros s Us. destruct (fail s) eqn:Hf; auto. right.
  destruct (safeb s) eqn:E; [right; now apply safe_iff|left; now apply dead_iff].
Qed.

Theorem safe_path : forall s, In s U -> Safe edge fail s <->
  exists w, IsPath edge w /\ w 0 = s /\ forall k, fail (w k) = false.
Proof. intros s Us. rewrite safe_iff by auto. now apply safeb_path. Qed.

Theorem time_finite : forall s, In s U ->
  (exists n, SurvivalTime edge fail s n) <-> ~ Safe edge fail s.
Proof.
  intros s Us. rewrite safe_iff by auto. split.
  - intros [n L] E. apply time_iff in L; auto.
    assert (X : safeb s = false) by (apply safeb_lasts; eauto). congruence.
  - intro E. destruct (safeb s) eqn:H; [congruence|]. apply safeb_lasts in H; auto.
    destruct H as [n L]. exists n. now apply time_iff.
Qed.

Theorem time_fun : forall m n s,
  SurvivalTime edge fail s m -> SurvivalTime edge fail s n -> m = n.
Proof. intros m n s [Fm Lm] [Fn Ln]. apply Nat.le_antisymm; auto. Qed.

Theorem time_zero : forall s, In s U -> SurvivalTime edge fail s 0 <-> fail s = true.
Proof. intros s Us. rewrite time_iff by auto. apply lasts_zero. Qed.

Theorem time_succ : forall n s, In s U -> SurvivalTime edge fail s (S n) <-> fail s = false /\
  (forall t, edge s t -> exists k, k <= n /\ SurvivalTime edge fail t k) /\
  exists t, edge s t /\ SurvivalTime edge fail t n.
Proof.
  intros n s Us. rewrite time_iff, lasts_succ by auto.
  split; intros [Hf [A [t [Ht L]]]]; (split; [exact Hf|]); split.
  - intros u Hu. apply edge_iff in Hu. destruct (A u Hu) as [k [Hk Lk]]. exists k. split; auto.
    apply time_iff; eauto.
  - exists t. split; [now apply edge_iff|]. apply time_iff; eauto.
  - intros u Hu. assert (E : edge s u) by now apply edge_iff.
    destruct (A u E) as [k [Hk Lk]]. exists k. split; auto. apply time_iff in Lk; eauto.
  - apply edge_iff in Ht. exists t. split; auto. apply time_iff in L; eauto.
Qed.

Theorem dead_time : forall s, In s U -> Dead edge fail s <-> exists n, SurvivalTime edge fail s (S n).
Proof.
  intros s Us. rewrite dead_iff by auto. split.
  - intros [Hf E]. apply safeb_lasts in E; auto. destruct E as [[|n] L].
    + apply lasts_zero in L. congruence.
    + exists n. now apply time_iff.
  - intros [n T]. apply time_iff in T; auto. split; [|apply safeb_lasts; eauto].
    now apply lasts_succ in T.
Qed.

Theorem horizon : forall D s, In s U -> (forall t, Dead edge fail t -> In t D) -> Dead edge fail s ->
  exists n, 1 <= n <= length D /\ SurvivalTime edge fail s n.
Proof.
  intros D s Us HD Ds. destruct (proj1 (dead_time s Us) Ds) as [n T]. exists (S n). split; auto.
  pose proof (proj1 (time_iff _ _ Us) T) as L. destruct (ladder _ _ Us L) as [l [Hl [Nl Al]]].
  split; [lia|]. rewrite <- Hl. apply NoDup_incl_length; auto. intros t Ht.
  destruct (Al t Ht) as [Ut [[|k] [Hk Lk]]]; [lia|]. apply HD, dead_time; auto.
  exists k. now apply time_iff.
Qed.

(** Along any path the survival time strictly decreases until failure. *)
Theorem dead_descends : forall s t m, In s U -> SurvivalTime edge fail s (S m) -> edge s t ->
  exists k, k <= m /\ SurvivalTime edge fail t k.
Proof. intros s t m Us T E. apply time_succ in T; auto. now apply T. Qed.

Theorem dead_acyclic : forall w i j, (forall k, In (w k) U) -> IsPath edge w -> i < j ->
  (forall k, i <= k <= j -> Dead edge fail (w k)) -> w i <> w j.
Proof.
  intros w i j HU P Hij D E.
  assert (Di : Dead edge fail (w i)) by (apply D; lia).
  destruct (proj1 (dead_time _ (HU i)) Di) as [n T].
  assert (A : forall d, i + d <= j -> exists k, k + d <= S n /\ SurvivalTime edge fail (w (i + d)) k).
  { induction d as [|d IH]; intro Hd.
    - exists (S n). rewrite !Nat.add_0_r. split; auto.
    - destruct IH as [[|k] [Hk Tk]]; [lia| |].
      + apply time_zero in Tk; auto. assert (Dd : Dead edge fail (w (i + d))) by (apply D; lia).
        destruct Dd. congruence.
      + rewrite Nat.add_succ_r. destruct (dead_descends (w (i + d)) (w (S (i + d))) k) as [m [Hm Tm]]; auto.
        exists m. split; auto. lia. }
  destruct (A (j - i)) as [k [Hk Tk]]; [lia|]. replace (i + (j - i)) with j in Tk by lia.
  rewrite <- E in Tk. pose proof (time_fun _ _ _ T Tk). lia.
Qed.
(** The largest survival time that one step enters from a safe state, or none. *)
Definition lastsb n s := negb (surv n s) && match n with O => true | S k => surv k s end.

Lemma lastsb_iff : forall n s, lastsb n s = true <-> lasts n s.
Proof.
  intros n s. unfold lastsb, lasts. rewrite andb_true_iff, negb_true_iff.
  split; intros [H L]; split; auto.
  - intros k Hk. destruct n as [|n]; [lia|]. apply (surv_le k n); auto. lia.
  - destruct n as [|n]; auto.
Qed.

Definition enters n := existsb (fun s => safeb s && existsb (lastsb n) (succs s)) U.

Lemma enters_iff : (forall s, In s U) -> forall n, enters n = true <->
  exists s t, Safe edge fail s /\ edge s t /\ SurvivalTime edge fail t n.
Proof.
  intros HU n. unfold enters. rewrite existsb_exists. split.
  - intros [s [Us H]]. apply andb_true_iff in H. destruct H as [Hs H]. apply existsb_exists in H.
    destruct H as [t [Ht L]]. exists s, t. split; [now apply safe_iff|]. split; [now apply edge_iff|].
    apply time_iff; auto. now apply lastsb_iff.
  - intros [s [t [Hs [E T]]]]. exists s. split; auto. apply andb_true_iff. split; [now apply safe_iff|].
    apply existsb_exists. exists t. split; [now apply edge_iff|]. apply lastsb_iff. now apply time_iff in T.
Qed.

Theorem boundary : (forall s, In s U) ->
  (exists h, (exists s t, Safe edge fail s /\ edge s t /\ SurvivalTime edge fail t h) /\
     forall s t n, Safe edge fail s -> edge s t -> SurvivalTime edge fail t n -> n <= h) \/
  (forall s t n, Safe edge fail s -> edge s t -> ~ SurvivalTime edge fail t n).
Proof.
  intro HU.
  assert (A : forall N, (forall s t n, Safe edge fail s -> edge s t -> SurvivalTime edge fail t n -> n < N) ->
    (exists h, (exists s t, Safe edge fail s /\ edge s t /\ SurvivalTime edge fail t h) /\
      forall s t n, Safe edge fail s -> edge s t -> SurvivalTime edge fail t n -> n <= h) \/
    (forall s t n, Safe edge fail s -> edge s t -> ~ SurvivalTime edge fail t n)).
  { induction N as [|N IH]; intro B.
    - right. intros s t n Hs E T. pose proof (B s t n Hs E T). lia.
    - destruct (enters N) eqn:H.
      + left. exists N. split; [now apply enters_iff|]. intros s t n Hs E T.
        pose proof (B s t n Hs E T). lia.
      + apply IH. intros s t n Hs E T. pose proof (B s t n Hs E T).
        destruct (Nat.eq_dec n N) as [->|]; [|lia].
        assert (X : enters N = true) by (apply enters_iff; eauto). congruence. }
  apply (A (S (length U))). intros s t n _ _ T. apply time_iff in T; auto.
  pose proof (lasts_bound n t (HU t) T). lia.
Qed.
End Retrograde.
