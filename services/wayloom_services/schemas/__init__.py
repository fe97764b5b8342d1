"""Request and response models of the API, by what they tell of."""
