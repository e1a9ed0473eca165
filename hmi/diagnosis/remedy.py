"""What a person does about a fault, by its code."""

from hmi.texts import Texts


def remedy(code: str, texts: Texts) -> str:
    """Text of the code, else of its group (`brake.weak`: `brake`), else of its ending (`lidar.blind`: `blind`)."""
    for name in (code.replace(".", "_"), code.partition(".")[0], code.rpartition(".")[2]):
        if f"remedy.{name}" in texts:
            return texts(f"remedy.{name}")
    return texts("remedy.other")
