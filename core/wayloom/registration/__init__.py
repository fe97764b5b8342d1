"""Registration of two place views: relative pose with covariance, or a refusal with its reason."""
