"""What only the owner of a copied model knows, and a platform asks."""

from typing import Annotated

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, HttpUrl, StringConstraints


def _without_password(url: HttpUrl) -> HttpUrl:
    if url.username or url.password:
        raise ValueError("leave user name and password out of the address")
    return url


Url = Annotated[HttpUrl, AfterValidator(_without_password)]
Note = Annotated[str, StringConstraints(max_length=2000)]


class Told(BaseModel):
    """What only the owner knows. It is put into the pack as the owner's word, and kept nowhere."""

    model_config = ConfigDict(extra="forbid", frozen=True)
    copy_url: list[Url] = Field([], max_length=20, description="Where the copy was found; give it once for each place.")
    original_url: Url | None = Field(None, description="Where the original is published.")
    note: Note = Field("", description="Your own words; set off from what was found.")
