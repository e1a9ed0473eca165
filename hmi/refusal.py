"""What the page refuses, with a reason that has a text in each language."""

from messages.errors import HeadlandError


class Refused(HeadlandError):
    """A request that is not possible now; `key` is that of a text under `refused`, `values` fill its places."""

    def __init__(self, key: str, **values: object) -> None:
        super().__init__(f"{key} {values}" if values else key)
        self.key, self.values = key, values
