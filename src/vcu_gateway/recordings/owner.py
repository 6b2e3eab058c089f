"""Rights of whom the recordings belong to, for a root that looks after them."""

import os
from pathlib import Path

from vcu_gateway.recordings.folder import read_error

_UMASK = 0o027


def act_as_owner(folder: Path) -> None:
    """Give up root's rights for those of the folder's owner, for good; nothing for other users.

    What is made then belongs to the recorder, which can remove it again. And what somebody put
    into the folder, such as a link to a file of root's, is of no use to him.
    """
    if os.geteuid() != 0:
        return
    try:
        owner = folder.stat()
    except OSError as error:
        raise read_error(error, folder) from error
    if owner.st_uid == 0:
        return
    os.umask(_UMASK)
    os.setgroups([])
    os.setresgid(owner.st_gid, owner.st_gid, owner.st_gid)
    os.setresuid(owner.st_uid, owner.st_uid, owner.st_uid)
