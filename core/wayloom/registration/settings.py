"""Settings of the registration of two place views."""

from pydantic import Field

from wayloom.config.settings import Settings


class RegistrationSettings(Settings):
    """What is searched, and what a pose must show to be believed."""

    max_point_sigma_m: float = Field(0.7, gt=0, le=20, description="points less certain than this along their ray are left out, m")
    radius_m: float = Field(50.0, ge=10, le=60, description="surroundings of the anchor that take part, m")
    yaw_step_deg: float = Field(2.0, gt=0, le=10, description="step of the search over headings, degrees")
    search_m: float = Field(30.0, ge=2, le=60, description="search without a prior: how far apart the two anchors may be, m")
    hypotheses: int = Field(6, ge=1, le=50, description="peaks of the search that are refined")
    prior_sigmas: float = Field(3.5, gt=0, le=10, description="poses farther than this from the prior are not searched")
    min_overlap: float = Field(0.2, ge=0, le=1, description="share of either view's points that the other must have seen")
    min_overlap_features: float = Field(0.1, ge=0, le=1, description="the same where many local features agree")
    min_overlap_alone: float = Field(0.05, ge=0, le=1, description="the same where local features alone know the pose")
    max_chance_log10: float = Field(
        -6.0, le=0, description="log10 of the number of false alarms of features that know a pose alone, at most"
    )
    max_feature_sigma_m: float = Field(0.1, gt=0, le=1, description="largest standard deviation of the place by such features, m")
    max_feature_sigma_deg: float = Field(0.3, gt=0, le=5, description="the same of the attitude, degrees")
    many_matches: int = Field(40, ge=4, description="local features that are many")
    min_score: float = Field(0.8, ge=0, description="mean log likelihood ratio of the points, where few local features agree")
    max_seen_through: float = Field(0.05, ge=0, le=1, description="share of points that may stand where the other view saw through")
    min_class_agreement: float = Field(0.8, ge=0, le=1, description="share of points near points whose class must agree")
    min_soundness: float = Field(0.735, ge=0, le=1, description="class agreement times (1 - share seen through)^5 with a prior")
    min_soundness_alone: float = Field(0.8, ge=0, le=1, description="the same without a prior")
    min_distinctness: float = Field(
        0.75, ge=0, description="mean log likelihood ratio above that elsewhere along the street, over the overlap, few features"
    )
    min_distinctness_same_way: float = Field(1.25, ge=0, description="the same where both look the same way and see the same sides")
    min_lead: float = Field(1.2, ge=1, le=10, description="times by which a pose must fit better than any other that passes")
    min_points: int = Field(150, ge=10, description="points of a view below which nothing is tried")
    min_matches: int = Field(12, ge=4, description="matched features that must agree for their pose to be tried")
    max_prior_chi2: float = Field(16.8, gt=0, description="chi-square, 6 degrees of freedom, of pose against prior at most")
    max_sigma_m: float = Field(0.5, gt=0, le=10, description="largest standard deviation of a believed position, m")
