"""What a policy is told of the state: filters, smoothers, predictors and their noise."""

__all__: list[str] = []
