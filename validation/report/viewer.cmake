# Fetches model-viewer (Apache-2.0) from the npm registry for the report's 3-D view: cmake -DOUT=DIR -DNPM=npm -P viewer.cmake
# By npm, which knows a mirror or proxy of its own; where there is none, by CMake from REGISTRY. Without the registry the
# build goes on, and the report says that the view is missing.
if(NOT REGISTRY)
  set(REGISTRY https://registry.npmjs.org)
endif()
set(version 4.1.0)
set(checksum 8367184a607fbe07a78b650c0d359e5ebbd96f7e2b22f95f761f559b63430386)  # SHA-256 of dist/model-viewer.min.js
set(target ${OUT}/model-viewer.min.js)
if(EXISTS ${target})
  file(SHA256 ${target} found)
  if(found STREQUAL checksum)
    return()
  endif()
endif()
set(scratch ${OUT}/download)
file(REMOVE_RECURSE ${scratch})
file(MAKE_DIRECTORY ${scratch})
if(NPM)
  execute_process(COMMAND ${NPM} pack --silent --fetch-retries=0 --fetch-timeout=60000 @google/model-viewer@${version} WORKING_DIRECTORY ${scratch} TIMEOUT 120
                  RESULT_VARIABLE status OUTPUT_QUIET ERROR_QUIET)
else()
  # One file of a fixed name, held against its checksum below.
  file(DOWNLOAD ${REGISTRY}/@google/model-viewer/-/model-viewer-${version}.tgz ${scratch}/model-viewer.tgz
       TIMEOUT 120 INACTIVITY_TIMEOUT 60 STATUS status)
endif()
file(GLOB archive ${scratch}/*.tgz)
if(archive)
  execute_process(COMMAND ${CMAKE_COMMAND} -E tar xzf ${archive} package/dist/model-viewer.min.js
                  WORKING_DIRECTORY ${scratch} OUTPUT_QUIET ERROR_QUIET)
endif()
set(file ${scratch}/package/dist/model-viewer.min.js)
if(EXISTS ${file})
  file(SHA256 ${file} found)
endif()
if(EXISTS ${file} AND found STREQUAL checksum)
  file(RENAME ${file} ${target})
elseif(EXISTS ${file})
  message(WARNING "model-viewer ${version} from the npm registry has another checksum: the report will lack its 3-D view")
else()
  message(STATUS "model-viewer is not to be had (npm registry): the report will lack its 3-D view")
endif()
file(REMOVE_RECURSE ${scratch})
