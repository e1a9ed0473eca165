"""`headland localize`: the localizer over a recording."""
