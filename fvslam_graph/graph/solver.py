"""iSAM2, over all time or a fixed lag, and what is done where its system is not determined."""

from __future__ import annotations

import logging
import re
from collections.abc import Callable, Iterable
from typing import Any

import gtsam
import numpy as np
from numpy.typing import NDArray

from fvslam_graph.core.config import GraphSettings
from fvslam_graph.core.errors import EstimationError
from fvslam_graph.graph.calibration import CALIBRATION, is_camera
from fvslam_graph.graph.factors import ENU, LASTING, is_at_fix, is_filed, is_landmark, is_pose, is_scale
from fvslam_graph.graph.marginalization import Marginalization, astray

_log = logging.getLogger(__name__)

WEAK_PRIOR_SIGMA = 10.0  # rad, m, of a logarithm: a prior that determines a variable and pulls at nothing
LOST_SCALE_SIGMA = 0.05  # of the logarithm of a scale, and of a bias of its source, whose measurements are lost
ANCHOR_SIGMA = 1e-3  # rad and m: the oldest pose within a lag, where what was before is lost
RELINEARIZE_ROTATION = 1e-3  # rad; a pose that turns by more is linearised again
RELINEARIZE_CALIBRATION = 1e-4  # of a coefficient of distortion, and of 1000 pixels of focal length, likewise
RELINEARIZE_CLOCK = 0.01  # seconds, likewise
RELINEARIZE_NEVER = 10**9  # updates
RELINEARIZE_GROWTH = 0.1  # by what share the number of updates grows until what has moved is linearised again
MARGINALIZE_AFTER = 10  # updates with other landmarks, after which one that was not seen again is marginalized
MAX_ROTATION_SIGMA = 0.05  # rad; landmarks seen from poses known less well may come to lie elsewhere, and are not
MAX_RECOVERIES = 20  # from one update that failed
_NAMED = re.compile(r"variable\s+(\d+)")


class Solver:
    """Takes in factors and variables, and has the maximum a posteriori of them all.

    Source: Kaess et al., "iSAM2", IJRR 31(2), 2012.

    Args:
        settings: When variables are linearised again, and for how many seconds they are kept.
    """

    def __init__(self, settings: GraphSettings) -> None:
        self._settings = settings
        self.recovered: list[str] = []  # variables that were not determined, in this order
        self._factors: list[tuple[float, gtsam.NonlinearFactorGraph]] = []  # by update, with its time; within the lag
        self._stamps: dict[int, float] = {}  # when each variable was seen last
        self._sighted: list[float] = []  # when landmarks were seen
        self._updates = 0
        self._relinearised = 0  # number of the update that linearised again what had moved
        self._due = False  # whether the next update is to do so
        self._covariances: dict[int, NDArray[np.float64]]  # that were asked for since the last update
        self._last_known = 0, np.eye(6)  # the last pose whose covariance was asked for, and that
        self._begin()

    def update(self, factors: gtsam.NonlinearFactorGraph, values: gtsam.Values, stamps: dict[int, float]) -> None:
        """Take in new factors, first values of new variables, and the time (s) of all variables seen now.

        Where that fails, the variable that the factors do not determine is named, gets a weak prior, and all is solved
        anew; where that does not suffice, without the landmarks seen last.

        Raises:
            EstimationError: The solver cannot recover.
        """
        now = max(stamps.values())
        self._covariances = {}
        self._factors.append((now, factors))
        self._stamps |= stamps
        if any(map(is_landmark, stamps)):
            self._sighted.append(now)
        if self._settings.lag is not None:
            begin = now - self._settings.lag
            self._factors = [(stamp, batch) for stamp, batch in self._factors if stamp >= begin]
            self._stamps = {key: stamp for key, stamp in self._stamps.items() if stamp >= begin}
        try:
            self._advance(factors, values, stamps)
        except RuntimeError as error:
            self._recover(error)

    def optimize(self) -> None:
        """Go to the maximum of all factors that are kept, with no landmark marginalized."""
        if self._settings.lag is not None:
            return
        try:
            optimum = gtsam.LevenbergMarquardtOptimizer(self.factors(), self.values()).optimize()
            self._begin_without(astray(self.factors(), optimum), optimum)
        except RuntimeError as error:
            self._recover(error)

    def forget(self, keys: set[int]) -> None:
        """Do without some variables, and all that is known of them; not within a lag."""
        self._begin_without(keys, self.values())

    def linearise_again(self) -> None:
        """Have the next update linearise again what has moved; within a lag every one does."""
        self._due = True

    def values(self) -> gtsam.Values:
        """The estimate of all variables, with landmarks that were marginalized.

        Where one is not determined, GTSAM has none of any: they are then where they were linearised.
        """
        try:
            values = self._solver.calculateEstimate()
        except RuntimeError:
            values = gtsam.Values(self._isam.getLinearizationPoint())
        self._marginalization.insert_marginalized(values)
        return values

    def factors(self) -> gtsam.NonlinearFactorGraph:
        """All factors that are kept."""
        whole = gtsam.NonlinearFactorGraph()
        for _, batch in self._factors:
            whole.push_back(batch)
        return whole

    def pose(self, key: int) -> gtsam.Pose3:
        """The estimate of a pose."""
        return self._solver.calculateEstimatePose3(key)

    def linearised(self, key: int) -> gtsam.Pose3:
        """Where factors of a pose are linearised."""
        return self._isam.getLinearizationPoint().atPose3(key)

    def calibration(self) -> gtsam.Cal3Bundler:
        """The estimate of the camera's calibration."""
        return self._solver.calculateEstimateCal3Bundler(CALIBRATION)

    def number(self, key: int) -> float:
        """The estimate of a number."""
        return float(self._solver.calculateEstimateDouble(key))

    def point(self, key: int) -> NDArray[np.float64]:
        """The estimate of a point (3,)."""
        point: NDArray[np.float64] = self._solver.calculateEstimatePoint3(key)
        return point

    def has(self, key: int) -> bool:
        """Whether the variable can be in new factors: it is known, not beyond the lag, and not marginalized."""
        return bool(self._isam.valueExists(key))

    def covariance(self, key: int) -> NDArray[np.float64]:
        """Marginal covariance of a variable."""
        if key not in self._covariances:
            self._covariances[key] = self._recovering(lambda: self._isam.marginalCovariance(key))
        if is_pose(key):
            self._last_known = key, self._covariances[key]
        return self._covariances[key]

    def joint_covariance(self, first: int, second: int) -> NDArray[np.float64]:
        """Marginal covariance (12, 12) of two poses."""
        keys = first, second
        joint = self._recovering(lambda: self._isam.jointMarginalCovariance(list(keys)))
        self._covariances |= {key: joint.at(key, key) for key in keys}
        if is_pose(second):
            self._last_known = second, self._covariances[second]
        return np.block([[joint.at(a, b) for b in keys] for a in keys])

    def _recovering(self, compute: Callable[[], Any]) -> Any:
        """Compute what may fail where the estimate itself did not."""
        try:
            return compute()
        except RuntimeError as error:
            self._recover(error, by_priors=False)
            return compute()

    @property
    def _isam(self) -> gtsam.ISAM2:
        return self._solver if self._settings.lag is None else self._solver.getISAM2()

    def _begin(self) -> None:
        self._covariances = {}
        self._solver = self._empty()
        self._marginalization = Marginalization()

    def _begin_without(self, gone: set[int], values: gtsam.Values) -> None:
        """A new solver, at these values, without some of the variables."""
        self._remove(gone.__contains__)
        for key in gone:
            values.erase(key)
        self._begin()
        self._take(self.factors(), values)

    def _empty(self) -> gtsam.ISAM2 | gtsam.IncrementalFixedLagSmoother:
        parameters = gtsam.ISAM2Params()
        thresholds = gtsam.ISAM2ThresholdMap()
        for pose in ("x", "y", "g", "e"):
            thresholds.insert((pose, np.repeat([RELINEARIZE_ROTATION, self._settings.relinearise], 3)))
        thresholds.insert(
            ("c", np.array([RELINEARIZE_CALIBRATION * 1e3, RELINEARIZE_CALIBRATION, RELINEARIZE_CALIBRATION]))
        )
        thresholds.insert(("l", np.full(3, self._settings.relinearise)))
        thresholds.insert(("t", np.full(1, RELINEARIZE_CLOCK)))
        for linear in ("s", "b", "h"):  # what depends on scales is linear
            thresholds.insert((linear, np.ones(1)))
        parameters.setRelinearizeThreshold(thresholds)
        parameters.relinearizeSkip = 1 if self._settings.lag is not None else RELINEARIZE_NEVER
        # Cholesky takes for undetermined what is known 4096 times less well than the variable before it.
        parameters.setFactorization("QR")
        parameters.findUnusedFactorSlots = True
        parameters.enablePartialRelinearizationCheck = True  # what does not move need not be looked at
        if self._settings.lag is None:
            return gtsam.ISAM2(parameters)
        return gtsam.IncrementalFixedLagSmoother(self._settings.lag, parameters)

    def _advance(self, factors: gtsam.NonlinearFactorGraph, values: gtsam.Values, stamps: dict[int, float]) -> None:
        if self._settings.lag is None:
            self._updates += 1
            self._take(factors, values)
            if self._due or self._updates - self._relinearised >= RELINEARIZE_GROWTH * self._updates:
                self._linearise_again(stamps)
            if self._updates % MARGINALIZE_AFTER == 0:
                self._marginalize()
        else:
            self._solver.update(factors, values, stamps)
        newest = max(filter(is_pose, stamps), key=stamps.__getitem__)  # older ones may be beyond the lag
        self._solver.calculateEstimatePose3(newest)  # throws, too, if at all
        if self.has(CALIBRATION) and not is_camera(self.calibration()):
            raise RuntimeError("the calibration has diverged")

    def _linearise_again(self, newest: Iterable[int]) -> None:
        """Linearise again what has moved, all at once, but for landmarks that came to lie behind a camera.

        There a projection says nothing: once linearised, they would not be determined. Without them the path is another
        one, behind which others may lie.
        """
        self._relinearised, self._due = self._updates, False
        while lost := astray(self._solver.getFactorsUnsafe(), self._solver.calculateEstimate()):
            self._remove(lost.__contains__)
            self._solver.update(gtsam.NonlinearFactorGraph(), gtsam.Values(), self._marginalization.drop(lost))
        again = gtsam.ISAM2UpdateParams()
        again.force_relinearize = True
        again.constrainedKeys = gtsam.KeyGroupMap()
        for key in filter(self.has, newest):  # eliminated last, since the next update is about them
            again.constrainedKeys.insert2(key, 1)
        self._solver.update(gtsam.NonlinearFactorGraph(), gtsam.Values(), again)

    def _take(self, factors: gtsam.NonlinearFactorGraph, values: gtsam.Values) -> None:
        self._marginalization.add(factors, self._solver.update(factors, values).getNewFactorsIndices())

    def _marginalize(self) -> None:
        """Marginalize landmarks that were not seen for a while, those that were seen last at the same time together.

        There are several times more landmarks than poses, and a new scale moves them all.
        """
        if len(self._sighted) <= MARGINALIZE_AFTER:
            return
        since = self._sighted[-1 - MARGINALIZE_AFTER]
        out_of_sight: dict[float, list[int]] = {}
        for landmark in self._marginalization:
            if self._stamps[landmark] <= since:
                out_of_sight.setdefault(self._stamps[landmark], []).append(landmark)
        added, removed = gtsam.NonlinearFactorGraph(), []
        for landmarks in out_of_sight.values():
            if self._may_turn(self._marginalization.seen_from(landmarks[0])):
                continue
            factors, slots = self._marginalization.marginalize(landmarks, self)
            added.push_back(factors)
            removed += slots
        self._solver.update(added, gtsam.Values(), removed)

    def _may_turn(self, pose: int) -> bool:
        """Whether the path may yet turn there, such as after images without landmarks."""
        turn = self._isam.marginalCovariance(pose)[:3, :3]
        return bool(np.trace(turn) > MAX_ROTATION_SIGMA**2)

    def _recover(self, error: RuntimeError, by_priors: bool = True) -> None:
        """A solver that has thrown is not sound: begin a new one with all factors, until it does not throw."""
        values = gtsam.Values(self._isam.getLinearizationPoint())
        self._marginalization.insert_marginalized(values)
        for key in set(values.keys()) - set(self._stamps):
            values.erase(key)
        if self._settings.lag is not None:
            self._keep_within(values)
        held: set[int] = set()
        for _ in range(MAX_RECOVERIES):
            found = _NAMED.search(str(error))
            key = int(found[1]) if found is not None and values.exists(int(found[1])) else None
            if by_priors and key is not None and key not in held | {CALIBRATION}:  # which has a prior: it is a landmark
                held.add(key)
                name = gtsam.DefaultKeyFormatter(key)
                _log.warning("%s is not determined by what was measured; it is held within %g", name, WEAK_PRIOR_SIGMA)
                self.recovered.append(name)
                self._add(_prior(key, values, WEAK_PRIOR_SIGMA))
            elif not self._drop_newest_landmarks(values):
                break
            self._begin()
            try:
                self._advance(self.factors(), values, {key: self._stamps[key] for key in values.keys()})  # noqa: SIM118
            except RuntimeError as again:
                error = again
            else:
                return
        if self._settings.lag is None:
            raise EstimationError(f"the factor graph cannot be solved: {' '.join(str(error).split())}") from error
        self._begin_where_it_was(values)

    def _drop_newest_landmarks(self, values: gtsam.Values) -> bool:
        """Do without the landmarks that the newest factors are about; whether there are any."""
        now = self._factors[-1][0]
        newest = [batch.at(slot) for stamp, batch in self._factors if stamp == now for slot in range(batch.size())]
        keys = {key for factor in newest if factor is not None for key in factor.keys()}  # noqa: SIM118
        dropped = {key for key in keys if is_landmark(key)}
        for key in dropped:
            values.erase(key)
        self._remove(lambda key: key in dropped)
        if dropped:
            _log.warning("the graph does without the %d landmarks that were seen last", len(dropped))
        return bool(dropped)

    def _begin_where_it_was(self, values: gtsam.Values) -> None:
        """Go on from where the path was, without all that was measured: the camera flies on.

        The last pose whose covariance was asked for keeps it, and the others within the lag keep their places beside
        it. What told the scale is lost.
        """
        _log.warning("the graph could not be solved; it begins anew where the camera was")
        for key in filter(lambda key: is_landmark(key) or is_at_fix(key), values.keys()):
            values.erase(key)
        now = self._factors[-1][0]
        self._factors = [(now, gtsam.NonlinearFactorGraph())]
        reference, covariance = self._last_known
        rigid = gtsam.noiseModel.Isotropic.Sigma(6, ANCHOR_SIGMA)
        for key in values.keys():  # noqa: SIM118
            if not (is_pose(key) or is_filed(key)) or not values.exists(reference):
                self._add(_prior(key, values, LOST_SCALE_SIGMA if is_scale(key) else ANCHOR_SIGMA))
            elif key == reference:
                noise = gtsam.noiseModel.Gaussian.Covariance(covariance)
                self._add(gtsam.PriorFactorPose3(key, values.atPose3(key), noise))
            else:
                motion = values.atPose3(reference).between(values.atPose3(key))
                self._add(gtsam.BetweenFactorPose3(reference, key, motion, rigid))
        self._begin()
        self._advance(self.factors(), values, {key: self._stamps[key] for key in values.keys()})  # noqa: SIM118

    def _keep_within(self, values: gtsam.Values) -> None:
        """Keep the factors whose variables are all within the lag.

        The oldest pose stays where it is, and the camera, its height, the place on Earth and the clock of fixes as they
        are: what held them is beyond the lag.
        """
        self._remove(lambda key: not values.exists(key))
        for lasting in filter(values.exists, LASTING):
            self._add(_prior(lasting, values, ANCHOR_SIGMA))
        oldest = min((key for key in values.keys() if is_pose(key)), key=lambda key: self._stamps[key])  # noqa: SIM118
        self._add(_prior(oldest, values, ANCHOR_SIGMA))

    def _remove(self, gone: Callable[[int], bool]) -> None:
        """Remove all factors about variables that are gone."""
        for _, batch in self._factors:
            for slot in range(batch.size()):
                factor = batch.at(slot)
                if factor is not None and any(gone(key) for key in factor.keys()):  # noqa: SIM118
                    batch.remove(slot)

    def _add(self, factor: gtsam.NonlinearFactor) -> None:
        batch = gtsam.NonlinearFactorGraph()
        batch.add(factor)
        self._factors.append((self._factors[-1][0], batch))


def _prior(key: int, values: gtsam.Values, sigma: float) -> gtsam.NonlinearFactor:
    """That a variable is where it is."""
    if is_pose(key) or is_filed(key) or is_at_fix(key) or key == ENU:
        return gtsam.PriorFactorPose3(key, values.atPose3(key), gtsam.noiseModel.Isotropic.Sigma(6, sigma))
    if key == CALIBRATION:
        return gtsam.PriorFactorCal3Bundler(key, values.atCal3Bundler(key), gtsam.noiseModel.Isotropic.Sigma(3, sigma))
    if is_landmark(key):
        return gtsam.PriorFactorPoint3(key, values.atPoint3(key), gtsam.noiseModel.Isotropic.Sigma(3, sigma))
    return gtsam.PriorFactorDouble(key, values.atDouble(key), gtsam.noiseModel.Isotropic.Sigma(1, sigma))
